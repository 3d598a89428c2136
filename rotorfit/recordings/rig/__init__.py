"""What a recording does not say itself: probes, marks and forces of the rig, and where they are written down."""
