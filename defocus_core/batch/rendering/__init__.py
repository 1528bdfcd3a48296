"""One job: read, focus, fit into memory, render, write.

Terms: `Loaded` is a decoded picture, `Outcome` the facts about a job for reports, `Rendering` the
computed images and maps. A region is a group of tiles that is rendered at once. Terms of memory are
in `memory_budget`.
"""
