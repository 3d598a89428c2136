"""From voltages to vectors: pulses, angles, orders, local models of spectra, dwells, start-ups and ring-downs."""
