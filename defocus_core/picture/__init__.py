"""What becomes of one picture: read, radii, scene, render, write; the rest is in the steps."""
