"""Why a simulator and reality part: which effect is missing, how sure, how much it explains."""
