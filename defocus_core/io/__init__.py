"""Files of pictures and depth, in and out: no lens and no rendering.

`picture_files` is the door for Python programs. A sibling: a hidden file beside an output, which it
becomes once it is whole.
"""
