"""What an integrator takes away: the calibrated robot in the formats of other programs."""
