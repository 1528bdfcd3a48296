"""Rendering of the picture that a lens takes: layers, blur, compositing, hidden content."""
