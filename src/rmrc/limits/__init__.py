"""The limits: all limits of one joint become one box in velocity."""
