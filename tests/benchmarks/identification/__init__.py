"""The figures of identification and tuning."""
