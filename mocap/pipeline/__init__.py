"""Pipeline: the stages, their store and the run; the only room that knows files, configuration, seeds and clocks."""
