"""Support for editors: the layout of files, language features, and the language server."""
