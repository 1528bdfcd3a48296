"""What may happen to a picture beside the plain path, one module each; `table` has the order."""
