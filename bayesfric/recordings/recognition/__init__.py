"""Recognising what the columns of a log are, by their names and by their values."""
