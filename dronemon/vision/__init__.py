"""Eyes: targets in pictures, and what they mean for the binary sensor."""
