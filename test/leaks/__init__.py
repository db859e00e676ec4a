"""Search for memory leaks: objects that many rounds of adding and removing things leave behind."""
