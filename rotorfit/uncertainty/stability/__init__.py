"""Whether a fitted rotor is stable enough at running speed."""
