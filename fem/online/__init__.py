"""What runs beside a user: steppers and what they share, in NumPy alone."""
