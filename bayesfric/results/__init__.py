"""What is concluded: for each number one value, one interval and one status."""
