"""From model files to FMUs, and calibrated values back into FMUs."""
