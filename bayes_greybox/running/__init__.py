"""Infrastructure: compiled programs and their cache, progress displays, tasks, files and limits."""
