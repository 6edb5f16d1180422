"""The arm: its chain of frames out and back, its statics. Knows neither files nor GTSAM."""
