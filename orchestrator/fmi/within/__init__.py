"""What an FMU gives within a communication step."""
