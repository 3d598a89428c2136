"""Before a test: the errors that it will have, and the speeds, planes, directions and lines that deserve its time."""
