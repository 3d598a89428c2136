"""Estimators: closed form, least squares, identifiability, uncertainty. They know models, but no files and no plots."""

if __name__ != "rotorfit.estimators":  # a second copy under another name would have classes of its own
    raise ImportError(f"import this package as rotorfit.estimators, not as {__name__}")
