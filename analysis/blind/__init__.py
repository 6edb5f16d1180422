"""The blind check: simulated test sessions with sealed ground truth, answers, and the score."""
