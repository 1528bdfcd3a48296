"""What people and CI servers look at: HTML, JUnit, contact sheets, plots, contents of files."""
