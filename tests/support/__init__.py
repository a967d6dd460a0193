"""What tests share: small FMUs, systems, recordings and the tools they are tried in."""
