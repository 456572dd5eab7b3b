"""What the balance of momentum shows of a rigid body, whatever the law of contact is."""
