"""How a run's page looks, beside what all pages have in common."""

STYLE = """
nav { margin: 1rem 0 0; padding: .4rem 0; border-block: 1px solid var(--line); font-size: .9rem; }
nav ul { display: flex; flex-wrap: wrap; gap: .1rem 1.1rem; margin: 0; padding: 0; list-style: none; }
nav a { text-decoration: none; }
nav a:hover { text-decoration: underline; }
.gates { margin: .75rem 0 0; padding: .75rem 1rem; list-style: none; background: var(--panel);
  border-radius: .5rem; font-size: .92rem; columns: 2 22rem; column-gap: 2rem; }
.gates li { padding-left: 1.4rem; text-indent: -1.4rem; break-inside: avoid; color: var(--faint); }
.gates .sign { display: inline-block; width: 1.4rem; text-indent: 0; font-weight: 700; }
.gates strong { font-weight: 600; }
.gates .failed { column-span: all; color: var(--bad); }
.gates .passed strong { color: var(--ink); }
.gates .passed .sign { color: var(--good); }
.highlights { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .75rem;
  margin: 1.25rem 0; }
.highlights div { display: flex; flex-direction: column-reverse; justify-content: flex-end; padding: .6rem .9rem;
  border: 1px solid var(--line); border-radius: .5rem; }
.highlights dt { color: var(--faint); font-size: .85rem; }
.highlights dd { margin: 0; font-size: 1.35rem; font-weight: 600; white-space: nowrap; }
.results td:first-child { width: 34%; }
.results td:nth-child(2) { width: 22%; text-align: right; font-weight: 600; white-space: nowrap; }
.results td:nth-child(3) { padding-left: 1rem; font-size: .9rem; }
.stages td:nth-child(3), .stages td:nth-child(4), .files td:nth-child(2) { white-space: nowrap; }
.stages ul { margin: .25rem 0; padding-left: 1.2rem; color: var(--accent); }
.share { display: block; width: 5rem; height: .3rem; margin-top: .3rem; border-radius: .15rem;
  background: linear-gradient(var(--mark) 0 0) 0 / var(--part) no-repeat var(--line); }
.reused { color: var(--faint); }
.sections { display: flex; gap: 1rem; align-items: end; justify-content: center; }
.plots { display: grid; gap: 1.25rem; grid-template-columns: repeat(auto-fit, minmax(21rem, 1fr)); align-items: start; }
.sections figure, .plots figure { margin: 0; }
.sections figure { flex: var(--wide); max-width: 26rem; min-width: 0; }
.sections img { width: 100%; max-height: none; padding: 0; background: none; }
rect.bar { fill: var(--mark); }
.curve { fill: none; stroke: var(--mark); stroke-width: 2.5; }
.findings { padding-left: 1.2rem; }
.findings li { margin: .4rem 0; }
.findings button, .buttons button { padding: .1rem .6rem; border: 1px solid var(--line); border-radius: .3rem;
  background: var(--panel); color: inherit; font: inherit; font-size: .85rem; cursor: pointer; }
.findings li::marker, .mark { color: var(--ink); }
.dot, .mark::before { content: ""; display: inline-block; width: .7rem; height: .7rem; margin-right: .35rem;
  border-radius: 50%; background: var(--own); }
.places { display: flex; flex-wrap: wrap; gap: .3rem; margin: .3rem 0; padding: 0; list-style: none; }
.places li { margin: 0; }
#view { margin: 1.5rem 0; }
.controls { display: flex; flex-wrap: wrap; gap: .5rem 1.1rem; align-items: center; min-height: 2.2rem;
  margin-bottom: .6rem; font-size: .9rem; }
.controls fieldset { display: flex; flex-wrap: wrap; gap: .2rem 1rem; flex-basis: 100%; margin: 0;
  padding: .2rem .8rem .5rem; border: 1px solid var(--line); border-radius: .5rem; }
#view-plane:not([hidden]) { display: inline-flex; flex-wrap: wrap; gap: .6rem; align-items: center; }
#view-plane label { display: inline-flex; gap: .4rem; align-items: center; }
#view-cut { width: 11rem; padding: 0; }
#view-place { min-width: 7rem; font-variant-numeric: tabular-nums; }
#view-stage .buttons { position: absolute; top: .7rem; right: .7rem; }
#view-stage { position: relative; height: clamp(20rem, 72vh, 44rem); border: 1px solid var(--line);
  border-radius: .5rem;  overflow: hidden; background: radial-gradient(circle at 50% 40%, var(--paper), var(--panel)); }
#view-canvas { display: block; width: 100%; height: 100%; cursor: grab; touch-action: none; }
#view-canvas:active { cursor: grabbing; }
#view-canvas:focus-visible { outline-offset: -3px; }
#view-bar { position: absolute; left: 1rem; bottom: .8rem; border-bottom: 3px solid var(--ink); font-size: .85rem;
  pointer-events: none; }
#view-legend:not([hidden]) { display: flex; gap: 1rem; align-items: start; margin-top: .6rem; font-size: .85rem; }
#view-legend > div { flex: 1; max-width: 24rem; }
.ramp { height: .8rem; border-radius: .2rem; }
#view-legend .marks { display: flex; justify-content: space-between; font-variant-numeric: tabular-nums; }
#view:fullscreen { display: flex; flex-direction: column; margin: 0; padding: 1rem; background: var(--paper); }
#view:fullscreen #view-stage { flex: 1; }
#view-help { font-size: .85rem; }
@media screen { .has-view .instead { display: none; } }
@media print { #view, nav, .places, .findings button { display: none; } .gates { columns: 1; }
  .plots { grid-template-columns: 1fr 1fr; }
  .plots details, .findings details { display: none; }
  .highlights dd { font-size: 1.05rem; } }
"""
