"""What people look at: HTML, JUnit, contact sheets, plots, the contents of a file."""
