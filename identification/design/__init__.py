"""The next experiment: what to excite a rig with so that a calibration's intervals become smallest, within limits."""
