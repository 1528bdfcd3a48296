"""The picture that a lens takes: layers, blur, compositing, content that is hidden."""
