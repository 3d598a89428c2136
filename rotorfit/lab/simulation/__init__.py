"""The virtual rig: tests of a model or structure, integrated in time."""
