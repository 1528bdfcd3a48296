"""One job: read, focus, fit into memory, render, write."""
