"""Optional steps on the path of a picture, one module each; `table` lists them in order."""
