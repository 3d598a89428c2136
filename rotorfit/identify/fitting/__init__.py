"""The fit: problem, solution, judgement, result, and what is made of several fits."""
