"""Execution by torch: threads, modes, checkpointing; and validation of arguments.

work: a function of one piece, such as a tile. mode: a setting of torch that changes its results or
its speed, such as autocast or inference. checkpointing: computing tensors again in a backward pass
instead of keeping them.
"""
