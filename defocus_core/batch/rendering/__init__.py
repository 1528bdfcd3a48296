"""One job: read, focus, fit into memory, render, write.

A `Job` becomes `Inputs`, decoded; then `Rendered`, its planes and what is known of them; then a
record of the journal. A region is a group of tiles that is rendered at once. Terms of memory are in
`memory_budget`.
"""
