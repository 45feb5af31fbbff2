"""Tables and words to paste into a paper."""
