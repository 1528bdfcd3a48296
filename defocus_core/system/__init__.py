"""The machine: safe files, memory, interrupts, errors, the console.

A scratch file: a file without a name that holds an array. A band: rows of an array that are in
memory at once. A sibling: a hidden file beside an output, which it becomes once it is whole.
"""
