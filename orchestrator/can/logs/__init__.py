"""Log files of CAN buses: any of them as batches of frames, and back."""
