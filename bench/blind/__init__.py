"""`bench blind`: flights whose cause is withheld are made, diagnosed, scored and reported."""
