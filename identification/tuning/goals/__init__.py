"""What is asked of loops: margins, responses, poles, noise; a file a family, joined in `table`."""
