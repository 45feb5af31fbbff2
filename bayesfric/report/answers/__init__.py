"""What a page answers with besides the summary: out of a fit, into ``page.json``, as data."""
