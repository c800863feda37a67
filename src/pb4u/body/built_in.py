"""Names of the built-in bodies."""

BUILT_IN = ("woman", "man")
DEFAULT_BODY = "woman"
