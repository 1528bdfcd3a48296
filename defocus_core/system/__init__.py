"""The machine: memory, processes, interrupts, the log, counts in words."""
