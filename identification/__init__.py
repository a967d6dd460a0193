"""From traces to parameters: signals, resonance, output error, validation."""
