"""Raw recordings: voltages of probes and Keyphasors as analysers store them, with the rig's setup.

Import from :mod:`rotorfit` or from the modules here; this file stays empty so that importing stays light.
"""
