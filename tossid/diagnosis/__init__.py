"""Why a simulator disagrees with recorded tosses: where, which effect, how far it closes."""
