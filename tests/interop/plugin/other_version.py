"""An agent of another version of pqsec. Its arguments are those of the true agent's start."""

import runpy

from pqsec_pki.plugin import calls

calls.VERSION += 1
runpy.run_module("pqsec_pki.plugin", run_name="__main__", alter_sys=True)
