"""Options that several commands have are written once."""

import inspect

from processing import __main__ as commands
from processing.batch.command import batch_command


def test_every_command_that_takes_a_template_has_the_same_option():
    takes = [commands.run, commands.register, commands.atlas, commands.register_mesh, batch_command]
    options = {id(inspect.signature(each).parameters["template"].default) for each in takes}
    assert len(options) == 1
