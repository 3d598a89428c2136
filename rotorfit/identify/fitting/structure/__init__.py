"""Structure of a fitted model: terms to add, laws to choose among, and what the choice is worth."""
