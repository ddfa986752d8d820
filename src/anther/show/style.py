"""How Anther shows things: colours, numbers in the units that people read, and the sheet of report and `serve`."""

from __future__ import annotations

import math

INK, GREEN, MAGENTA, ORANGE = "#1d2a22", "#2f7d4f", "#c2389a", "#d9772b"
STEM_COLOR, BRANCH_COLOR, TRUSS_COLOR, LEAF_COLOR = "#b3261e", "#1f6fb2", "#d97706", "#2e8540"
FLOWER_COLOR, GRASP_COLOR, SHAKE_COLOR, PREDICTED_COLOR = "#e0a100", MAGENTA, "#2866e6", "#f03cc8"
SUPPORT_COLOR = "#7b3fb5"
ROBOT_COLOR, GRIPPER_COLOR, POT_COLOR, VIEW_COLOR, CLOUD_COLOR = "#a5a8af", "#464850", "#787878", "#5a6eaa", "#9db89f"
"""What is what in every picture, scene and log."""
NARROW = 640
"""Screens up to this width get the pictures and tables of a phone [px]."""
NOT_MEASURED = "not measured"


def rgb(colour: str) -> tuple[int, int, int]:
    """Return "#rrggbb" as three numbers 0..255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def quantity(value: float | None, unit: str) -> str:
    """Return a value of an SI unit as people read it, three digits: "1.18 mm", "0.98 %"; what is not known says so."""
    if value is None or not math.isfinite(value):
        return NOT_MEASURED
    # SI unit of a value -> factor and unit in which people read it; others are shown as they are
    units = {
        "m": (1e3, "mm"),
        "m/s": (1e3, "mm/s"),
        "m/s2": (1.0, "m/s²"),
        "-": (100.0, "%"),
        "Pa": (1e-6, "MPa"),
    }
    factor, shown = units.get(unit, (1.0, unit))
    value *= factor
    digits = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:.{min(digits, 3)}f} {shown}".strip()


_SHEET = """
:root { --ink:#1d2a22; --soft:#5d6b62; --line:#dfe6e1; --leaf:#2f7d4f; --fair:#b7791f; --bad:#b3402e;
  --paper:#ffffff; --ground:#f4f7f5 }
* { box-sizing:border-box } body { margin:0; background:var(--ground); color:var(--ink);
  font:16px/1.5 system-ui,"Segoe UI",Roboto,"Helvetica Neue",sans-serif }
main { max-width:1080px; margin:0 auto; padding:32px 24px 64px }
h1 { font-size:28px; margin:0 0 4px } h2 { font-size:20px; margin:0 0 12px } p { margin:0 0 12px }
.soft { color:var(--soft) } section { background:var(--paper); border:1px solid var(--line); border-radius:10px;
  padding:20px 24px; margin-top:20px } img { width:100%; height:auto; display:block; border-radius:6px }
table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums } th,td { text-align:left;
  padding:6px 12px 6px 0; border-bottom:1px solid var(--line); vertical-align:top }
th { font-weight:600; color:var(--soft) }
td.n, th.n { text-align:right } tr:last-child td { border-bottom:0 }
.verdict { border-left:8px solid var(--leaf) } .verdict.held { border-left-color:var(--fair) }
.verdict.failed { border-left-color:var(--bad) }
.facts { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:16px; margin-top:12px }
.facts b { display:block; font-size:22px; font-weight:600 } .facts span { color:var(--soft); font-size:14px }
.answers { display:grid; grid-template-columns:repeat(auto-fit,minmax(240px,1fr)); gap:16px }
.answer b { display:block; font-size:26px } .answer span { color:var(--soft); font-size:14px }
b.yes, b.pollinated { color:var(--leaf) } b.held { color:var(--fair) } b.no, b.failed { color:var(--bad) }
.bar { display:flex; height:26px; border-radius:6px; overflow:hidden; margin-bottom:14px } .bar i { display:block }
.key { display:inline-block; width:10px; height:10px; border-radius:2px; margin-right:8px }
li { margin-bottom:4px } footer { margin-top:28px; color:var(--soft); font-size:14px }
.wide { overflow-x:auto; margin-bottom:12px }
img.film { width:420px; max-width:100% } summary { cursor:pointer; color:var(--soft) }
tr.chosen td { background:#eef6f0 } td { overflow-wrap:break-word }
@media @narrow { main { padding:16px 10px 32px } section { padding:14px 12px } h1 { font-size:22px }
  .answer b { font-size:20px } .facts b { font-size:18px } .facts { grid-template-columns:1fr 1fr }
  .cards tr:has(th) { position:absolute; clip-path:inset(50%); width:1px; height:1px; overflow:hidden }
  .cards, .cards tbody { display:block }
  .cards tr { display:block; padding:8px 0; border-bottom:1px solid var(--line) }
  .cards td { display:flex; justify-content:space-between; gap:16px; border:0; padding:2px 0; text-align:right }
  .cards td:first-child { font-weight:600; justify-content:flex-start; align-items:baseline; text-align:left;
    overflow-wrap:anywhere }
  .cards td:empty { display:none } .cards tr:last-child { border-bottom:0 }
  .cards td[data-name]::before { content:attr(data-name); color:var(--soft); font-weight:400; text-align:left;
    overflow-wrap:break-word } }
@media print { body { background:none } section { border:0; padding:0; break-inside:avoid-page }
  details { display:none } }
"""
STYLE = _SHEET.replace("@narrow", f"(max-width:{NARROW}px)")
