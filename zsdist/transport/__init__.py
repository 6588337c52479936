"""How bytes get from one role to another; nothing here knows what they mean."""
