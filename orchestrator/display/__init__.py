"""What figures and tables look like, in reports and notebooks; of plain numbers and texts."""
