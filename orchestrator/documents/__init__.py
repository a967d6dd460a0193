"""YAML files as maps that know where each key stands, joined from several files where they share parts."""
