"""Figures for papers, their captions and their files."""
