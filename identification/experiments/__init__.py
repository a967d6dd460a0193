"""The manipulator thesis' campaign: its data sets, tables and claims."""
