"""Files of pictures and depth, in and out: no lens and no rendering.

`picture_files` is the module for Python programs. A sibling: a hidden file beside an output file,
which is renamed to the output once it is complete.
"""
