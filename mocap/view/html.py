"""Building blocks of the pages that people look at: one HTML file that stands alone, its tables, cards and figures.

Nothing is loaded from anywhere; a content security policy inside the file forbids it.
"""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mocap.errors import MocapError
from mocap.metrics.catalogue import score_of, score_text

Section = Literal["accuracy", "silhouettes", "tracks", "timing", "other"]


@dataclass(frozen=True)
class Figure:
    """One plot: image holds the bytes of a PNG, JPEG or SVG file, alt says in words what it shows."""

    title: str
    caption: str
    image: bytes
    mime: str = "image/png"
    section: Section = "other"
    alt: str = ""


@dataclass(frozen=True)
class PageSection:
    """A section of a page.  key : its anchor.  content : HTML.  is_folded : opened by who wants to see it."""

    key: str
    title: str
    content: str
    is_folded: bool = False


def page_html(title: str, kicker: str, sections: Sequence[PageSection], *, subtitle: str = "") -> str:
    """A whole page: head, navigation, sections, enlarged pictures.  kicker : what kind of page.  subtitle : HTML."""
    navigation = "".join(f'<a href="#{s.key}">{escaped(s.title)}</a>' for s in sections)
    body = "".join(_section(section) for section in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">"
        f"<title>{escaped(title)}</title><style>{_STYLE}</style></head><body>"
        f'<header><p class="kicker">{escaped(kicker)}</p><h1>{escaped(title)}</h1>{subtitle}'
        f'<nav aria-label="Sections">{navigation}</nav></header><main>{body}</main>'
        '<dialog id="zoom" aria-label="Enlarged picture"><img alt=""><p></p></dialog>'
        f"<script>{_SCRIPT}</script></body></html>\n"
    )


def _section(section: PageSection) -> str:
    head = f'<h2 id="h-{section.key}">{escaped(section.title)}</h2>'
    content = f"{head}{section.content}"
    if section.is_folded:
        content = f"<details><summary>{head}</summary>{section.content}</details>"
    return f'<section id="{section.key}" aria-labelledby="h-{section.key}">{content}</section>'


def write_html(path: Path, text: str, *, what: str) -> None:
    """Write a page; an earlier file is replaced only when the new one is complete.

    what : the page in the words of the error.  Raises MocapError when the file cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        if part.exists():
            part.unlink()
        raise MocapError(
            f"{what} cannot be written: {error.strerror or error}",
            remedy="choose a folder that exists, is writable and has space left",
            path=path,
        ) from error


def escaped(value: object) -> str:
    """Text for a page; a percent sign stays with its number."""
    return html.escape(str(value), quote=True).replace(" %", "\u00a0%")


def faint(sentence: str) -> str:
    """A sentence in place of what is not there."""
    return f'<p class="faint">{escaped(sentence)}</p>'


def number_text(value: float | None, unit: str = "") -> str:
    """A number with as many digits as mean something: tenths with a unit, thousandths of a plain ratio."""
    if value is None or not np.isfinite(value):
        return "unknown"
    if unit:
        return f"{value:.1f}"
    return f"{int(value)}" if float(value).is_integer() else f"{value:.3f}"


def data_uri(content: bytes, mime: str) -> str:
    """A picture inside the page."""
    return f"data:{html.escape(mime)};base64,{base64.b64encode(content).decode('ascii')}"


def warning_list(warnings: Sequence[str]) -> str:
    """Warnings one below the other; what follows "Remedy:" in one of them is set apart."""
    if not warnings:
        return faint("None.")
    out = '<ul class="warnings">'
    for warning in warnings:
        what, _, remedy = str(warning).partition("Remedy:")
        out += f"<li><p>{escaped(what.strip())}</p>"
        if remedy.strip():
            out += f'<p class="remedy"><strong>What helps:</strong> {escaped(remedy.strip())}</p>'
        out += "</li>"
    return out + "</ul>"


def score_cards(scores: Mapping[str, float | None], keys: Sequence[str]) -> str:
    """Cards with the scores of these keys that apply; empty when none does."""
    cards = ""
    for key in keys:
        if (value := scores.get(key)) is None:
            continue
        score = score_of(key)
        unit = f" <small>{escaped(score.unit)}</small>" if score.unit else ""
        cards += (
            f'<div class="card"><p class="name">{escaped(score.name)}</p>'
            f'<p class="value">{score_text(value, score)}{unit}</p>'
            f'<p class="hint">{escaped(score.meaning)}</p></div>'
        )
    return cards


def score_table(scores: Iterable[tuple[str, float | None]]) -> str:
    """A table of (key, value): name, key, value with unit and what it means; None = does not apply."""
    rows = ""
    for key, value in scores:
        score = score_of(key)
        shown = "does not apply" if value is None else f"{score_text(value, score)} {escaped(score.unit)}"
        style = "number faint" if value is None else "number"
        rows += (
            f'<tr><th scope="row">{escaped(score.name)}<br><code>{escaped(key)}</code></th>'
            f'<td class="{style}">{shown}</td><td>{escaped(score.meaning)}</td></tr>'
        )
    return (
        '<div class="scroll"><table><thead><tr><th scope="col">Score</th><th scope="col" class="number">Value</th>'
        f'<th scope="col">What it means</th></tr></thead><tbody>{rows}</tbody></table></div>'
    )


def plain_table(rows: Iterable[tuple[object, object]]) -> str:
    """A table of names and values, without a head."""
    body = "".join(f'<tr><th scope="row">{escaped(k)}</th><td>{escaped(v)}</td></tr>' for k, v in rows)
    return f'<div class="scroll"><table class="plain"><tbody>{body}</tbody></table></div>'


def figures_html(figures: Iterable[Figure]) -> str:
    """Plots one below the other; selecting one enlarges it."""
    out = ""
    for figure in figures:
        alt = figure.alt or f"Plot: {figure.title}. {figure.caption}"
        out += (
            '<figure class="plot"><button type="button" class="zoom" title="Enlarge">'
            f'<img src="{data_uri(figure.image, figure.mime)}" alt="{escaped(alt)}"></button>'
            f"<figcaption><strong>{escaped(figure.title)}</strong> {escaped(figure.caption)}</figcaption></figure>"
        )
    return out


def verdict_on_scores(scores: Mapping[str, float | None] | None) -> list[str]:
    """What the scores say in plain sentences; one sentence when there are none."""
    if not scores or all(v is None for v in scores.values()):
        return ["This session has no ground truth, so nothing is scored: judge the pictures by eye."]
    sentences = []
    if (mean := scores.get("mean_error_mm")) is not None:
        sentences.append(_landmark_verdict(mean, scores.get("mmta_percent"), scores.get("epsilon_mm")))
    mota = scores.get("mota_percent")
    if mota is not None:
        switches = scores.get("mismatches")
        tail = "" if switches is None else f", with {switches:g} identity switch{'es' * (switches != 1)}"
        sentences.append(f"Tracking of persons is {mota:.1f} % accurate (MOTA){tail}.")
    return sentences


def _landmark_verdict(mean_mm: float, share_percent: float | None, epsilon_mm: float | None) -> str:
    sentence = f"Landmarks lie {mean_mm:.0f} mm from the truth on average"
    if share_percent is None:
        return sentence + "."
    within = f"within {epsilon_mm:g} mm" if epsilon_mm is not None else "close enough"
    quality = (
        "the body was followed throughout"
        if share_percent >= 95
        else "mostly right, but limbs are lost at times"
        if share_percent >= 70
        else "limbs or the whole body are lost for long stretches"
    )
    return f"{sentence}, and {share_percent:.1f} % of them {within}: {quality}."


_STYLE = """
:root{color-scheme:light dark;--ground:#f5f6f8;--card:#fff;--ink:#1d2329;--faint:#626c78;--line:#dde1e6;
--accent:#0b63a5;--good:#0a7a55;--bad:#b3400a;--warn:#fff6e3;--warnline:#e6a100}
@media (prefers-color-scheme:dark){:root{--ground:#15181c;--card:#1f2429;--ink:#e8ebee;--faint:#9aa5b1;
--line:#343b43;--accent:#6db8ef;--good:#45c797;--bad:#ff9a5c;--warn:#332a14;--warnline:#c58d08}}
*{box-sizing:border-box}
body{margin:0;background:var(--ground);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",
Roboto,"Noto Sans","DejaVu Sans",sans-serif}
header,main{max-width:1180px;margin:0 auto;padding:0 24px}
header{padding-top:36px}
.kicker{margin:0;color:var(--faint);font-size:13px;letter-spacing:.08em;text-transform:uppercase}
h1{margin:2px 0 4px;font-size:30px;line-height:1.2;overflow-wrap:anywhere}
h2{margin:0 0 12px;font-size:20px}
h3{margin:18px 0 4px;font-size:17px}
h4{margin:10px 0 6px;font-size:14px;color:var(--faint);font-weight:600}
.session{margin:0 0 14px;color:var(--faint);overflow-wrap:anywhere}
nav{display:flex;flex-wrap:wrap;gap:4px 18px;padding:10px 0;border-top:1px solid var(--line);font-size:15px}
nav a{color:var(--accent);text-decoration:none}
nav a:hover,nav a:focus-visible{text-decoration:underline}
section summary h2{display:inline;margin:0}
section{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:22px 24px;margin:0 0 18px;
scroll-margin-top:12px}
.lead{font-size:19px;margin:0 0 8px}
p{max-width:86ch;margin:0 0 10px}
.badge{display:inline-block;margin-left:6px;padding:1px 10px;border:1px solid currentColor;border-radius:99px;
font-size:13px;font-weight:600}
.good{color:var(--good)}.bad{color:var(--bad)}.faint{color:var(--faint)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:12px;margin:16px 0}
.card{border:1px solid var(--line);border-radius:8px;padding:12px 14px}
.card p{margin:0}.card .name{font-size:13px;color:var(--faint);font-weight:600}
.card .value{font-size:28px;font-weight:650;line-height:1.3;font-variant-numeric:tabular-nums}
.card small{font-size:15px;font-weight:500}.card .hint{font-size:12.5px;line-height:1.4;color:var(--faint)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;margin:6px 0 14px;font-size:15px}
table.plain,table.narrow{width:auto;min-width:min(420px,100%)}
th,td{text-align:left;vertical-align:top;padding:6px 14px 6px 0;border-bottom:1px solid var(--line)}
th{font-weight:600}thead th{color:var(--faint);font-size:13px}tfoot th,tfoot td{font-weight:650;border-bottom:0}
td.number,th.number{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums;padding-right:24px}
.bar{width:50%;vertical-align:middle}.bar i{display:block;height:10px;background:var(--accent);border-radius:2px}
code,pre{font-family:ui-monospace,"DejaVu Sans Mono",Menlo,Consolas,monospace;font-size:13px}
th code{font-weight:400;color:var(--faint)}
pre{background:var(--ground);border:1px solid var(--line);border-radius:6px;padding:12px;overflow-x:auto;
white-space:pre-wrap;overflow-wrap:anywhere}
summary{cursor:pointer;font-weight:600;margin:6px 0}
.warnings{list-style:none;margin:0;padding:0}
.warnings li{background:var(--warn);border-left:4px solid var(--warnline);border-radius:4px;padding:10px 14px;
margin:0 0 10px}
.warnings p{margin:0}.warnings .remedy{margin-top:4px}
.legend{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:14px;color:var(--faint)}
.legend i{display:inline-block;width:14px;height:14px;margin-right:6px;border-radius:3px;vertical-align:-2px;
border:1px solid #0006}
.legend i.depth{width:44px;background:linear-gradient(90deg,#00306f,#7b7b78,#fde737)}
.strip{display:grid;grid-template-columns:repeat(auto-fit,minmax(190px,1fr));gap:10px}
figure{margin:0}.shot figcaption{font-size:13.5px;color:var(--faint);padding:3px 0 6px}
.zoom{display:block;width:100%;padding:0;border:0;background:none;cursor:zoom-in;border-radius:6px}
.zoom:focus-visible{outline:3px solid var(--accent);outline-offset:2px}
.zoom img{display:block;width:100%;height:auto;border-radius:6px}
.plot{margin:14px 0 18px}.plot .zoom{max-width:1000px;background:#fff;border:1px solid var(--line);padding:8px}
.plot .zoom img{width:auto;max-width:100%;margin:0 auto}
.plot figcaption{font-size:14.5px;padding-top:6px;max-width:86ch;color:var(--faint)}
.plot figcaption strong{color:var(--ink)}
#replay-player[hidden]{display:none}
.stage{display:grid;grid-template-columns:minmax(0,3fr) minmax(0,2fr);gap:12px;align-items:start}
canvas.scene{display:block;width:100%;aspect-ratio:4/3;border:1px solid var(--line);border-radius:6px;
touch-action:none;cursor:grab}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(105px,1fr));gap:6px}
.tiles figure{min-width:0}.tiles canvas{display:block;width:100%;height:auto;border-radius:4px;background:#0002}
.tiles figcaption{font-size:12.5px;color:var(--faint);overflow-wrap:anywhere}
.transport{display:flex;flex-wrap:wrap;align-items:center;gap:8px;margin:10px 0 0}
.transport input[type=range]{flex:1;min-width:140px;accent-color:var(--accent)}
.transport button,button.copy,button.seek{font:inherit;padding:2px 12px;border:1px solid var(--line);border-radius:6px;
background:var(--ground);color:var(--ink);cursor:pointer}
.transport .play{min-width:5.2em}
.transport output{min-width:15ch;font-weight:600;font-variant-numeric:tabular-nums}
.charts{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(330px,100%),1fr));gap:14px 18px;
margin:8px 0 18px}
.curve figcaption{font-size:14px;display:flex;flex-wrap:wrap;gap:2px 8px;align-items:baseline}
.curve small{color:var(--faint)}.curve .keys{display:flex;flex-wrap:wrap;gap:0 10px;color:var(--faint);margin-left:auto}
.key{display:inline-block;width:14px;height:3px;margin-right:5px;vertical-align:middle}
.chart{display:block;width:100%;height:auto}.timed{cursor:crosshair}
.chart text{font:11px system-ui,sans-serif;fill:var(--faint)}
.chart .grid{stroke:var(--line)}.chart .cursor{stroke:var(--ink);stroke-width:1;opacity:.6}
.chart .band{stroke:none;opacity:.2}.chart .line{fill:none;stroke-width:1.8;stroke-linejoin:round}
.chart .unseen{stroke-dasharray:2 4;opacity:.8}
.chart .left{stroke:#2f86d6}.chart .band.left{fill:#2f86d6}.key.left{background:#2f86d6}
.chart .right{stroke:#e07b1a}.chart .band.right{fill:#e07b1a}.key.right{background:#e07b1a}
.chart .middle{stroke:#7a8794}.chart .band.middle{fill:#7a8794}.key.middle{background:#7a8794}
.chart .c0{stroke:#0072b2}.key.c0{background:#0072b2}.chart .c1{stroke:#d55e00}.key.c1{background:#d55e00}
.chart .c2{stroke:#009e73}.key.c2{background:#009e73}.chart .c3{stroke:#cc79a7}.key.c3{background:#cc79a7}
.chart .c4{stroke:#e69f00}.key.c4{background:#e69f00}.chart .c5{stroke:#56b4e9}.key.c5{background:#56b4e9}
.chart .c6{stroke:#7a8794}.key.c6{background:#7a8794}.chart .c7{stroke:#8c6d31}.key.c7{background:#8c6d31}
textarea.summary{width:100%;font-family:ui-monospace,"DejaVu Sans Mono",Menlo,Consolas,monospace;font-size:12.5px;
background:var(--ground);color:var(--ink);border:1px solid var(--line);border-radius:6px;padding:8px;resize:vertical}
@media (max-width:720px){header,main{padding:0 10px}section{padding:16px 12px}
.stage{grid-template-columns:minmax(0,1fr)}
h1{font-size:24px}.card .value{font-size:23px}}
.slider{display:flex;flex-wrap:wrap;align-items:center;gap:10px;margin:12px 0;position:sticky;top:0;z-index:2;
background:var(--card);padding:8px 0}
.slider[hidden],.frame[hidden]{display:none}
.slider input[type=range]{flex:1;min-width:160px;accent-color:var(--accent)}
.slider button{font:inherit;padding:2px 12px;border:1px solid var(--line);border-radius:6px;background:var(--ground);
color:var(--ink);cursor:pointer}
.slider output{min-width:8ch;font-weight:600;font-variant-numeric:tabular-nums}
dialog{border:0;padding:12px;border-radius:10px;background:#111;color:#eee;max-width:96vw;max-height:96vh}
dialog::backdrop{background:#000b}
dialog img{display:block;max-width:92vw;max-height:84vh;min-width:min(70vw,720px);margin:0 auto;object-fit:contain}
dialog p{margin:8px 0 0;font-size:14px}
.sr{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}
@media print{:root{--ground:#fff;--card:#fff;--ink:#000;--faint:#444;--line:#bbb;--accent:#0b63a5;color-scheme:light}
body{font-size:11pt}nav,.slider{display:none!important}.frame[hidden]{display:block!important}
section{border:0;padding:0 0 12pt;margin:0}figure,tr,li,.card{break-inside:avoid}h2,h3,h4{break-after:avoid}
.strip{grid-template-columns:repeat(var(--n,4),1fr)}}
"""

_SCRIPT = """
"use strict";
(function(){
var box=document.getElementById("zoom"),big=box.querySelector("img"),text=box.querySelector("p");
document.querySelectorAll("button.zoom").forEach(function(b){b.addEventListener("click",function(){
var i=b.querySelector("img");big.src=i.src;big.alt=i.alt;text.textContent=i.alt;box.showModal();});});
box.addEventListener("click",function(){box.close();});
document.querySelectorAll("button.copy").forEach(function(b){b.addEventListener("click",function(){
var t=document.getElementById(b.dataset.of);t.select();
function done(){b.textContent="Copied";}
if(navigator.clipboard){navigator.clipboard.writeText(t.value).then(done,function(){document.execCommand("copy");done();});}
else{document.execCommand("copy");done();}});});
function unfold(){var s=location.hash&&document.getElementById(location.hash.slice(1));
var d=s&&s.querySelector("details");if(d){d.open=true;}}
window.addEventListener("hashchange",unfold);unfold();
var bar=document.querySelector(".slider");if(!bar){return;}
var frames=document.querySelectorAll(".frame"),range=bar.querySelector("input[type=range]");
var all=bar.querySelector("input[type=checkbox]"),out=bar.querySelector("output");
function show(){frames.forEach(function(f,i){f.hidden=!all.checked&&i!==+range.value;});
out.textContent="frame "+frames[+range.value].dataset.frame;}
range.addEventListener("input",show);all.addEventListener("change",show);
bar.querySelectorAll("button").forEach(function(b){b.addEventListener("click",function(){
range.value=+range.value+ +b.dataset.step;show();});});
bar.hidden=false;show();
})();
"""
