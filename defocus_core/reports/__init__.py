"""Reports for people and CI servers: HTML, JUnit, Markdown, contact sheets, contents of files."""
