"""From a recording to the experiment that a fit takes: responses, lines of the shaft, positions, free vibration."""
