"""The machine: safe files, memory, interrupts, errors, the console."""
