"""Tests of programs: files with inputs and expectations, and their execution."""
