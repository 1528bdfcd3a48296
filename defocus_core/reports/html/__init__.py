"""Pages of one HTML file that people look at: comparisons, goldens, a focus to choose.

Terms: an item is a row of a report, a pair. A layer is a picture or a map of an
item. A thumbnail is a small 8-bit picture of a layer; its halves are its values as half floats,
all of them or those of a window. A payload is either of the two, as text in the file.
"""
