"use strict";
(function(){
var root=document.getElementById("replay-player");if(!root){return;}
var data=JSON.parse(document.getElementById("replay-data").textContent);
var scene=root.querySelector("canvas.scene"),range=root.querySelector("input[type=range]");
var out=root.querySelector("output"),playing=null,at=0;
var still=window.matchMedia&&window.matchMedia("(prefers-reduced-motion: reduce)").matches;
var view={az:-0.9,el:0.3,zoom:1.25},pictures={},order=[];
var middle=[0,1].map(function(k){return(data.lower[k]+data.upper[k])/2;}).concat([0.9]);
var size=Math.max(data.upper[0]-data.lower[0],data.upper[1]-data.lower[1],2.5);
function colour(name,fallback){return getComputedStyle(document.documentElement).getPropertyValue(name).trim()||fallback;}
function projector(){
 var w=scene.width,h=scene.height,ca=Math.cos(view.az),sa=Math.sin(view.az),ce=Math.cos(view.el),se=Math.sin(view.el);
 var away=2.2*size/view.zoom,f=1.25*Math.min(w,1.3*h);
 return function(p){
  var x=p[0]-middle[0],y=p[1]-middle[1],z=p[2]-middle[2];
  var right=-sa*x+ca*y,fore=-ca*x-sa*y,depth=away+fore*ce-z*se,up=z*ce+fore*se;
  if(depth<0.15){return null;}
  return[w/2+f*right/depth,h/2-f*up/depth,f/depth,depth];};
}
function line(g,project,a,b,style,width){
 var p=project(a),q=project(b);if(!p||!q){return;}
 g.strokeStyle=style;g.lineWidth=width;g.beginPath();g.moveTo(p[0],p[1]);g.lineTo(q[0],q[1]);g.stroke();
}
function label(g,text,x,y){
 g.fillText(text,Math.max(2,Math.min(x,scene.width-g.measureText(text).width-2)),Math.max(y,12));}
function floor(g,project,faint){
 var x,y,l=data.lower,u=data.upper;
 for(x=Math.ceil(l[0]);x<=u[0];x++){line(g,project,[x,l[1],0],[x,u[1],0],faint,1);}
 for(y=Math.ceil(l[1]);y<=u[1];y++){line(g,project,[l[0],y,0],[u[0],y,0],faint,1);}
}
function rig(g,project,ink){
 data.cameras.forEach(function(c){
  c.corners.forEach(function(k,i){line(g,project,c.centre,k,ink,1);line(g,project,k,c.corners[(i+1)%4],ink,1);});
  var p=project(c.centre);if(p&&p[0]>0&&p[0]<scene.width){g.fillStyle=ink;label(g,c.name,p[0]+4,p[1]-4);}});
}
function point(person,i,m){var v=person.points[i];if(!v||v[3*m]===null){return null;}
 return[v[3*m]/1000,v[3*m+1]/1000,v[3*m+2]/1000];}
function trail(g,project,person,i){
 for(var k=Math.max(1,i-Math.round(data.fps*1.5));k<=i;k++){
  var a=point(person,k-1,0),b=point(person,k,0);
  if(a&&b){line(g,project,[a[0],a[1],0],[b[0],b[1],0],person.colour,2);}}
}
function body(g,project,person,i){
 var bones=[];
 person.bones.forEach(function(b){
  var p=point(person,i,b[0]),q=point(person,i,b[1]);if(!p||!q){return;}
  var s=project(p),t=project(q);if(s&&t){bones.push([s,t,b[2],b[3]]);}});
 bones.sort(function(a,b){return b[0][3]+b[1][3]-a[0][3]-a[1][3];});
 g.lineCap="round";
 bones.forEach(function(b){
  var thick=Math.max(2,2*b[3]*(b[0][2]+b[1][2])/2);
  [["#0008",thick+2],[data.colours[b[2]],thick]].forEach(function(s){
   g.strokeStyle=s[0];g.lineWidth=s[1];g.beginPath();g.moveTo(b[0][0],b[0][1]);g.lineTo(b[1][0],b[1][1]);g.stroke();});});
 g.lineCap="butt";
 var top=person.head===null?null:point(person,i,person.head),p=top&&project([top[0],top[1],top[2]+0.12]);
 if(p){g.fillStyle=person.colour;label(g,person.name,p[0]-18,p[1]);}
}
function drawScene(){
 var ratio=window.devicePixelRatio||1,w=Math.max(200,Math.round(scene.clientWidth*ratio));
 var h=Math.max(150,Math.round(scene.clientHeight*ratio));
 if(scene.width!==w||scene.height!==h){scene.width=w;scene.height=h;}
 var g=scene.getContext("2d"),project=projector();
 g.clearRect(0,0,w,h);g.font=Math.round(12*ratio)+"px system-ui,sans-serif";
 floor(g,project,colour("--line","#ccc"));rig(g,project,colour("--faint","#888"));
 data.persons.forEach(function(p){trail(g,project,p,at);});
 data.persons.forEach(function(p){body(g,project,p,at);});
}
function drawPictures(){
 if(!data.pictures.length){return;}
 var frame=data.frames[at],k=0;
 while(k+1<data.picture_frames.length&&data.picture_frames[k+1]<=frame){k++;}
 function put(image){
  if(!image.naturalWidth){return;}
  root.querySelectorAll("canvas.tile").forEach(function(c,n){
   var t=data.tiles[n];c.getContext("2d").drawImage(image,t[0],t[1],t[2],t[3],0,0,t[2],t[3]);});}
 if(pictures[k]){if(pictures[k].complete){put(pictures[k]);}return;}
 var image=new Image();pictures[k]=image;order.push(k);
 if(order.length>60){delete pictures[order.shift()];}
 image.onload=function(){put(image);};image.src="data:"+data.mime+";base64,"+data.pictures[k];
}
function cursors(){
 document.querySelectorAll("svg.timed").forEach(function(s){
  var d=s.dataset,share=(data.frames[at]-d.first)/Math.max(1,d.last-d.first);
  var c=s.querySelector(".cursor"),x=+d.left+share*(d.right-d.left);
  c.setAttribute("x1",x);c.setAttribute("x2",x);c.style.visibility=share<0||share>1?"hidden":"visible";});
}
function show(i){
 at=Math.max(0,Math.min(data.frames.length-1,i));range.value=at;
 out.textContent=(data.frames[at]/data.fps).toFixed(2)+" s, frame "+data.frames[at];
 drawScene();drawPictures();cursors();
}
function seek(frame){
 var best=0;
 data.frames.forEach(function(f,i){if(Math.abs(f-frame)<Math.abs(data.frames[best]-frame)){best=i;}});
 show(best);
}
function play(on){
 var button=root.querySelector("button.play");
 if(playing){clearInterval(playing);playing=null;}
 if(on){var step=data.step/data.fps*1000;
  playing=setInterval(function(){show(at+1<data.frames.length?at+1:0);},Math.max(25,step));}
 button.textContent=on?"Pause":"Play";button.setAttribute("aria-pressed",on?"true":"false");
}
range.max=data.frames.length-1;
range.addEventListener("input",function(){show(+range.value);});
root.querySelector("button.play").addEventListener("click",function(){play(!playing);});
root.querySelectorAll("button[data-step]").forEach(function(b){
 b.addEventListener("click",function(){play(false);show(at+ +b.dataset.step);});});
document.addEventListener("keydown",function(e){
 var tag=e.target.tagName;
 if(/^(INPUT|TEXTAREA|SELECT|BUTTON|SUMMARY|A)$/.test(tag)&&!(e.target===range&&e.key===" ")){return;}
 if(e.key===" "){e.preventDefault();play(!playing);}
 else if(e.target!==range&&(e.key==="ArrowRight"||e.key==="ArrowLeft")){
  e.preventDefault();play(false);show(at+(e.key==="ArrowRight"?1:-1));}});
var drag=null,touches={};
scene.addEventListener("pointerdown",function(e){scene.setPointerCapture(e.pointerId);
 touches[e.pointerId]=[e.clientX,e.clientY];drag=[e.clientX,e.clientY];});
scene.addEventListener("pointermove",function(e){
 if(!touches[e.pointerId]){return;}
 var ids=Object.keys(touches);
 if(ids.length===2){
  var other=touches[ids[0]===String(e.pointerId)?ids[1]:ids[0]],old=touches[e.pointerId];
  var before=Math.hypot(old[0]-other[0],old[1]-other[1]),now=Math.hypot(e.clientX-other[0],e.clientY-other[1]);
  if(before>1){view.zoom=Math.max(0.4,Math.min(6,view.zoom*now/before));}
 }else{view.az-=(e.clientX-drag[0])*0.008;
  view.el=Math.max(-0.1,Math.min(1.55,view.el+(e.clientY-drag[1])*0.008));}
 touches[e.pointerId]=[e.clientX,e.clientY];drag=[e.clientX,e.clientY];drawScene();});
["pointerup","pointercancel"].forEach(function(n){
 scene.addEventListener(n,function(e){delete touches[e.pointerId];});});
scene.addEventListener("wheel",function(e){e.preventDefault();
 view.zoom=Math.max(0.4,Math.min(6,view.zoom*Math.exp(-e.deltaY*0.001)));drawScene();},{passive:false});
scene.addEventListener("dblclick",function(){view={az:-0.9,el:0.3,zoom:1.25};drawScene();});
document.querySelectorAll("svg.timed").forEach(function(s){s.addEventListener("click",function(e){
 var box=s.getBoundingClientRect(),d=s.dataset,x=(e.clientX-box.left)/box.width*s.viewBox.baseVal.width;
 var frame=+d.first+(x-d.left)/(d.right-d.left)*(d.last-d.first);
 play(false);seek(frame);});});
document.querySelectorAll("button.seek").forEach(function(b){b.addEventListener("click",function(){
 play(false);seek(+b.dataset.frame);document.getElementById("replay").scrollIntoView();});});
window.addEventListener("resize",drawScene);
root.hidden=false;root.classList.toggle("still",!!still);show(0);root.dataset.ready="yes";
})();
