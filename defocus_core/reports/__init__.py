"""Reports for people and CI servers: HTML, JUnit, contact sheets, plots, contents of files."""
