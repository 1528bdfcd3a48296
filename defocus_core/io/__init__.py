"""Files of pictures and depth, in and out: no lens and no rendering.

`picture_files` is the door for Python programs. A scratch file: a file without a name that holds an
array. A band: rows of an array that are in memory at once. A sibling: a hidden file beside an
output, which it becomes once it is whole.
"""
