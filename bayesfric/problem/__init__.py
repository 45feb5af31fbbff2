"""What is asked: a configuration, and all that it names, read and prepared."""
