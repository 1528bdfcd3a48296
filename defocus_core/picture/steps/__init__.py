"""Optional steps of the path of a picture, one module each; `table` has the order."""
