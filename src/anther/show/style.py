"""How Anther's pages look: the report of a run and what `anther history serve` shows are one product."""

STYLE = """
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
.wide { overflow-x:auto } img.film { width:320px; max-width:100% } summary { cursor:pointer; color:var(--soft) }
tr.chosen td { background:#eef6f0 } td { overflow-wrap:break-word }
@media (max-width:600px) { main { padding:16px 10px 32px } section { padding:14px 12px } h1 { font-size:22px }
  .answer b { font-size:20px } .facts b { font-size:18px } }
@media print { body { background:none } section { border:0; padding:0; break-inside:avoid-page }
  details { display:none } }
"""
