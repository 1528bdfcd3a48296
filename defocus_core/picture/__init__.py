"""The path of one picture: read, radii, scene, render, write, and optional steps."""
