"""Files that programs name: their paths, permissions and modules."""
