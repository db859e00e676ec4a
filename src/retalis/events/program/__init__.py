"""Program files: reading, checking and loading."""
