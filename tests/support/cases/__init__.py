"""Small inputs on which the product once went wrong, kept outside the project, and what must come of them now."""
