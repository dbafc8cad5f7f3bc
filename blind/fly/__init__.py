"""How the flights of a case come about: realities, disturbances, references."""
