# SPDX-License-Identifier: Apache-2.0
"""Errors a user can act on: each message says what was found, where, and what to do.

The exit code of the command line is a property of the error, so that the panel, the batch runner
and the shell agree on what went wrong.
"""


class RobirError(Exception):
    """Base of every error whose message is meant for the user; the process ends by `exit_code`."""

    exit_code = 1


class UsageError(RobirError):
    """The command or a path given to it makes no sense; nothing was started."""

    exit_code = 2


class ConfigError(UsageError):
    """A setting is unknown, of the wrong type or out of range."""


class CaptureError(RobirError):
    """The capture cannot be read or cannot be reconstructed."""

    exit_code = 3


class DeviceError(RobirError):
    """No usable device, not enough memory, or Blender is not to be found."""

    exit_code = 4


class QualityError(RobirError):
    """The fit ended but failed its own quality check."""

    exit_code = 5


class StorageError(RobirError):
    """A file of the result folder cannot be written, read or trusted."""

    exit_code = 6


class CancelledError(RobirError):
    """The user asked the run to stop; the folder can be resumed."""

    exit_code = 130
