"""Effects with memory hidden in forced oscillators whose position and force are measured."""
