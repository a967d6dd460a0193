"""Tables of text as people have them: how one is written is said by the layout, else seen in its first lines."""
