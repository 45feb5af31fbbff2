"""What several runs say together of a quantity that differs from one to the next."""
