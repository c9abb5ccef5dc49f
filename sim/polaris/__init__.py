"""An NDI Polaris that answers its command set on a pseudo-terminal or TCP."""
