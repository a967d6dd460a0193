"""The search for parameters: free runs over windows made to match what was measured, through any simulator."""
