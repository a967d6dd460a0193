"""What is settled before the first step: the order and the ticks of components, and which tangents a run carries."""
