"""What is believed before the recordings are looked at: read, chosen by default, evaluated."""
