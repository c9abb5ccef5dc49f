"""What every campaign needs: units of work, who does them, the record of them, tables and plots."""
