"""Pages of one HTML file each: comparisons, goldens, the choice of a focus.

Terms: an item is a row of a report, a pair. A layer is a picture or a map of an
item. A thumbnail is a small 8-bit picture of a layer; the halves of a layer are its values as half
floats, of the whole or of a window. A payload is a thumbnail or halves, as text in the file.
"""
