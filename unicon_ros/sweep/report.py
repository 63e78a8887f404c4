"""x"""
def write_report(results): return "-"
