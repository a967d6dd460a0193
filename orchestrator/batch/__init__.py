"""Many runs: suites of scenarios and procedures of commands."""
