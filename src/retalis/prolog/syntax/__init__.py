"""Reading and writing of Prolog terms and of event text."""
