"""Errors that foveate raises on purpose."""


class InputError(ValueError):
    """Wrong input: a setting, a file, an option or an argument that foveate cannot take.

    The message is one line that names the field, file or argument, its value and what would be right. The command line
    prints it and exits with status 2; any other exception is a bug of foveate.
    """
