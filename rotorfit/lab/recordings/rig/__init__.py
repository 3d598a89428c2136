"""Description of the rig of a recording: probes, marks and forces of the rig, and where they are written down."""
