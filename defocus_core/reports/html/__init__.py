"""Pages of one HTML file each: reports, whose items have layers; the choice of a focus."""
