"""Web page that shows what a running engine does."""
