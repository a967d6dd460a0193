"""The figures of CAN buses and logs."""
