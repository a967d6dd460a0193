"""Systems, records and studies whose truth is known."""
