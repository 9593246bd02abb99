_PQSEC_COMPLETE=fish_source pqsec | source
