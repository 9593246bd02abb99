"""An agent whose participant may do whatever it likes, as if nobody had signed anything.

Its arguments are those of the true agent's start.
"""

import runpy

from pqsec_pki.plugin.access_control import AccessControl


def _yes(*_):
    return (0,)


AccessControl._refuse_unless = _yes
AccessControl.check_create_topic = AccessControl.check_remote_topic = _yes
runpy.run_module("pqsec_pki.plugin", run_name="__main__", alter_sys=True)
