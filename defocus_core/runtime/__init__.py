"""How torch runs: threads, modes, checkpointing, and the checks of arguments."""
