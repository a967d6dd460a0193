"""Which of several models recordings speak for: candidates of a study, judged by criteria and by what they predict."""
