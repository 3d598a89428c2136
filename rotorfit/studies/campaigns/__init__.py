"""Many runs fitted alike, and what their parameters follow."""
